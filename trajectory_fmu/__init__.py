"""The desired path and its joint angles, in numpy, free of FMI."""
