"""First-time stories: data as somebody would bring it, diagnosed by the command line."""
