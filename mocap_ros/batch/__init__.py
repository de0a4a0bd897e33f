"""Many recordings, on the cores of one machine or on a cluster (Dask): docs/corpora.md."""
