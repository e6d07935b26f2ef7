"""Many runs of a system with varied values. Dask takes a second to load, so this package hands out nothing by itself."""
