"""Air showers as calibrated signals: read coreas, signals, recording, slopes, contours in this order."""
