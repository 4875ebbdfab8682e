"""The methods that CN-DHF compares with, each from its paper. fields.py is what they share."""
