"""Makers of products: from rows in arrays, from signals without a matrix of lags, at an estimate."""
