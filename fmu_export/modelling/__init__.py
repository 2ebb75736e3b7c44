"""What a model is made of: variables, functions, units, composition; models import nothing else."""
