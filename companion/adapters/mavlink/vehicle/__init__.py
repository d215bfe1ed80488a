"""The vehicle's side: who it is, what it sends at which rate, its clock."""
