"""Sky models: brightness temperature by direction and frequency."""
