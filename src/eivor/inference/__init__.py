"""Inference for estimating equations."""
