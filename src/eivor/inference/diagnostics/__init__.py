"""Diagnostics: strength of instruments, tests of equations, residuals and constancy."""
