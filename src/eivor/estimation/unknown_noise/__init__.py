"""Parameters together with the strengths, and orders, of measurement noises that nobody declared."""
