"""Systems of FMUs as SSP files, and what runs, varies, replays and compares them. Knows FMUs and SSP only as files."""
