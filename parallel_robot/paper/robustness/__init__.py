"""The robustness study that the paper lacks: what is uncertain, what comes of it, and what the gains trade off."""
