"""Finding and knowing one controller: its address, its options, its identity, and its clock."""
