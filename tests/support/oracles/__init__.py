"""The robot in other engines of multibody dynamics, from the same parameters and from none of our equations."""
