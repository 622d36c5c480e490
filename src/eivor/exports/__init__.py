"""From a result to where its numbers are used: parameters of autopilots, models of controllers, draws.

A target is one final class in a file of its own, and one row of `eivor.exports.targets`.
"""
