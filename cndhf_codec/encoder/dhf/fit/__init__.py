"""Train the networks: each double height field alone on height targets, then all together on samples of the solid."""
