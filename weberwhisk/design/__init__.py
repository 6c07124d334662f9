"""The design of behavioural experiments: which distances, offsets, trials and animals, and why."""
