"""The history of the schema, run by `lbacal db upgrade`."""
