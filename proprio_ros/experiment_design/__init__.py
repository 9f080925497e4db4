"""What to push next: candidates, predicted precision, sequences chosen one by one, and when to stop."""
