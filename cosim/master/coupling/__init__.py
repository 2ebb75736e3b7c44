"""How components are coupled: order and extrapolation, loops, iterated and variable steps, model exchange."""
