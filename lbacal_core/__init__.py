"""The physics: arrays and frozen values in, frozen values out. Read `pipeline` first, then `calibration`."""
