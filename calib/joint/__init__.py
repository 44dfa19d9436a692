"""The joint problem: microphones, sound, board and camera in one least-squares adjustment."""
