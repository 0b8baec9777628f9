"""What the twin can hide: faults by their place between the sky and the converter, and those no catalogue lists.

Read `fault`, `sky`, `hardware`, then `catalogue` for the list, `uncatalogued` and `composed`.
"""
