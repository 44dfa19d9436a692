"""The devices: three small protocols, and the concrete devices that fill them."""
