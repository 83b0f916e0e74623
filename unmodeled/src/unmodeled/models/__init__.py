"""What a model is: the names that an author of one needs."""
