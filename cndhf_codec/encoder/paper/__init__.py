"""The method of CN-DHF as published: axes by area, fields fitted alone, one loss bound for the rounding."""
