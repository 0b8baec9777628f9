"""Routes: each reads the request, calls one use case and answers. See `request`, then `problems`."""
