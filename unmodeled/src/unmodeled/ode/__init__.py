"""Integration of equations: rates are traced once, many jobs run together with derivatives."""
