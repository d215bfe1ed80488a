"""Speed, memory and accuracy figures, side by side with the alternatives."""
