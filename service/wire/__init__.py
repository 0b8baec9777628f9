"""What travels over HTTP: request bodies, answers and their formats. Read `answers` first."""
