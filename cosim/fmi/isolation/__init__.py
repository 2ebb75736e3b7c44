"""FMUs that live in processes of their own: nothing that they do ends more than their process."""
