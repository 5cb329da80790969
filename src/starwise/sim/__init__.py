"""Truth in, measurements out: sky, vehicle, receiver, inertial sensors; never what a filter believes."""
