"""People as messages that other packages' planners and monitors take in; a parameter switches each of them on."""
