"""Connection data of one controller: address, options, identity, and clock."""
