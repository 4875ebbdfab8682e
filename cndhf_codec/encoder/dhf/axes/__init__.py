"""Which axes the double height fields look along, and how wide their networks are."""
