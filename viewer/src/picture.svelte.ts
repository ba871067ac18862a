// The picture of the stage, for who wants to keep it.

class Picture {
  /** Gives it as a PNG; null before there is one. */
  take = $state.raw<(() => Promise<Blob>) | null>(null);
}

export const picture = new Picture();
