"""What the pictures of a diagnosis show: motions, and the evidence of each change."""
