"""What is wrong with a station, from minutes to a day of its spectra: read `audit`, then a file a question."""
