"""Studies of the paper and its contests with rival methods; uses the public names of `tissuereg`."""
