"""Solomon & Hartmann (2011) remade: its figures' numbers, its equations and its claims."""
