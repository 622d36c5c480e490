"""What changes over the members of groups in their order: drifts, steps, members that deviate.

Every function works on many groups at once, as those of `eivor.inference.random_effects` do.
"""
