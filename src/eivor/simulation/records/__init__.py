"""Records of a sampled loop: scenario, controllers, simulation."""
