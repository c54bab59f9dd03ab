"""What every room may use: checks of arguments and arrays, clocks, locks, the machine; knows nothing of bodies."""
