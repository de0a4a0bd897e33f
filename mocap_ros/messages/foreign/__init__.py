"""Messages of other packages' detectors, a file a package."""
