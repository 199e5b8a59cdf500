"""Tables, pictures and animations of results."""
