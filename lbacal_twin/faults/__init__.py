"""What the twin can hide: faults by their place between the sky and the converter, and those no catalogue lists.

Read `sky`, `antenna`, `cable`, `receiver`, `interference`, then `catalogue` for the list, and `uncatalogued`.
"""
