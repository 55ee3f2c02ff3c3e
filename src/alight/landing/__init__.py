"""Landing: sites and the reasons against them, next view, reserve, route."""
