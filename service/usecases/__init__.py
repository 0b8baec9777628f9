"""What the service does, one file a use case; each opens its own transactions and knows neither HTTP nor SQL."""
