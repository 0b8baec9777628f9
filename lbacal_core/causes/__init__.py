"""Physical causes of a wrong simulation, one file a stage of the chain: read `cause`, then `catalogue`."""
