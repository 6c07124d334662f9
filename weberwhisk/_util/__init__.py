"""What modules of all rooms share: checks of input, values, files, threads and long sweeps."""

__all__: list[str] = []
