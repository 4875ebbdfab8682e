"""The method of CN-DHF as published: axes by area, single fits only, and a bound on the loss for the rounding."""
