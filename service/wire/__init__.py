"""What travels over HTTP: instants, request bodies and the formats of answers. Read `instants` first."""
