"""Why a robot stopped: the data around a stop, the codes of the controller, and the search for the cause."""
