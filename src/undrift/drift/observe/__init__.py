"""What thermal sessions show: made ready, cut into blocks of rest and dwells at a rate, gathered over sessions."""
