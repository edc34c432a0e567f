"""What a gear is made for and what it has carried: sizes, maker's laws, load cycles, and the ledger of its life."""
