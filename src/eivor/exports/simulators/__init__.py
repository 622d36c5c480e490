"""A result as files of simulators. A simulator needs a mass, which no flight tells, and where the rotors are.

A target is one final class in a file of its own, and one row of `eivor.exports.targets`. All of them take the
vehicle from `described`, in one set of words and units, and settle how their simulator counts it.
"""
