"""PD control of an arm's joints along smooth steps."""
