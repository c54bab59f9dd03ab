"""A virtual twin of the paper's phantom rig (section IV, Fig. 9), simulated by scikit-fem."""
