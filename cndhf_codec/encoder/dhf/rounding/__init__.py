"""Round weights to whole multiples of their steps, with error feedback, to the target size."""
