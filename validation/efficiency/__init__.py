"""How near the methods come to the Cramer-Rao bound."""
