"""2D keypoint detectors that run on images; `detectors.load` chooses the one that a model file is for."""
