"""Landing: sites or the reasons against them, next views, reserve sites, routes."""
