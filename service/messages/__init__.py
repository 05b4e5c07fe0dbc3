"""What clients say and what they are told: schemas, the vocabulary of 3GPP, documents."""
