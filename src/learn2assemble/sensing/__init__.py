"""What a cell sees: depth cameras, poses of blocks and tags, calibration."""
