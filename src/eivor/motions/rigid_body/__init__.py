"""The rigid body on rotors: equation (1) of the paper in body rates."""
