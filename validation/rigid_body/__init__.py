"""The rigid body identified from rotor commands, against the truth of the simulator."""
