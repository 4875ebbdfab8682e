"""The methods that CN-DHF compares with, each from its paper. networks.py is what they share."""
