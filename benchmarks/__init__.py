"""Speed, measured in one run against limits and peers: ``torchrl-atr bench``. Not part of the installed package."""
