"""A frozen controller: its data, its file, its limits and the margins that it promises."""
