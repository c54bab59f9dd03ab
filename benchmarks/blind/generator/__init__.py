"""Makes experiments with a hidden effect. Imports nothing from the package that is tested."""
