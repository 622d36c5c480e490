"""Estimation: assemblers, weightings and methods, the search for nuisance parameters, and estimates.

The room is not called `identify`, because `eivor.identify` is the function.
"""
