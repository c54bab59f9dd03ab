"""Files in and out: each format one module, units converted here alone. Writers leave a whole file or none."""
