"""What the service does, one file a deed; each opens its own transactions and knows neither HTTP nor SQL."""
