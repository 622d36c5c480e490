"""Friction of flights in gusts: the rigid body, joint in all axes, against the vertical motion alone."""
