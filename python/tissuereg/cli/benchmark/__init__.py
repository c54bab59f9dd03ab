"""Times by stage: what the command ``tissuereg bench`` measures."""
