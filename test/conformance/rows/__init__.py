"""The rows, one module a kind; each has `ROWS`."""
