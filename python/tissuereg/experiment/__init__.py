"""An experiment (a rig, loads and measurements), material tests, and the physical effects that may have occurred."""
