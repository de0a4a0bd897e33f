"""Methods of others that the project is compared with, each written from its paper."""
