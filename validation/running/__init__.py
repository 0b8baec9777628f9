"""A PostgreSQL server and processes of the service, for proofs and for the tests."""
