"""The engine of the diagnosis: fit, score, search, held-out records, verdict."""
