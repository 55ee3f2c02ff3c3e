"""From hazards to a landing: sites, next view, reserve and route."""
