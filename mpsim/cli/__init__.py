"""The command line, a module per group of commands; nothing else prints."""
