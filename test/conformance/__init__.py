"""What is right of recordings that have gone wrong: one row for each trouble, which this package passes and others can be asked."""
