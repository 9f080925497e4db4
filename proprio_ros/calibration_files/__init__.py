"""What a calibration is on disk: from pushes, from motions, of one joint; whose arm it is, and how it ages."""
