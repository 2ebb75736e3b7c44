"""FMU files as somebody else's: archives, model descriptions and libraries are checked before anything of them runs."""
