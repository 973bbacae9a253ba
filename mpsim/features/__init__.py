"""What a scene may have besides discs in a box, a file for each."""
