"""The messages of the masks for Nav2's costmap filters."""
