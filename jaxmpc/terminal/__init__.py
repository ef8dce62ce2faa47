"""What several verbs share on the command line: arguments, process settings, tables, progress."""
