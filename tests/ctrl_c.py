"""What makes a command that a test starts listen to Ctrl-C."""

# A shell that runs the tests in the background makes all that they start ignore SIGINT.
CTRL_C = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
