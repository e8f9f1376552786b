"""How large effects are, what may be there unseen (`not_excluded`), and from which size it would show (`resolves`)."""
