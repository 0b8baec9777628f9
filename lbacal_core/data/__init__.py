"""Numbers with their citations."""
