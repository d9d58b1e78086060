"""From a deformed gel to the picture that the sensor's camera takes of it.

    displacement --height_map--> how far the surface has come towards the camera, at every pixel
                 --blur--> the same, smoothed --shading--> image
"""
