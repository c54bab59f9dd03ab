"""`python -m tissuereg_training`."""

from tissuereg_training.cli import run

if __name__ == "__main__":
    run()
