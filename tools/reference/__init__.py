"""Pages of docs/reference, each from its source."""
