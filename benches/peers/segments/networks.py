"""The networks that the paper holds its own against, in Keras, with the settings of their authors' code.

Each takes (batch, frames, inputs) and gives a logit per class and frame; frames must be a multiple of 4 for ED-TCN.
"""
import keras
from keras import layers


def norm_relu(x):
    """ReLU divided by the largest channel of the frame."""
    x = keras.ops.relu(x)
    return x / (keras.ops.max(x, axis=-1, keepdims=True) + 1e-5)


def dt_fcn(inputs, classes, width=3):
    """Cheema et al. 2019, with one input row per joint."""
    x = entry = keras.Input((None, inputs))
    for layer, filters in enumerate((64, 64, 128, 256, 512)):
        x = layers.Conv1D(filters, width, padding="same", dilation_rate=width**layer)(x)
        x = layers.ReLU()(x) if layer < 4 else layers.Lambda(norm_relu)(x)
    return keras.Model(entry, layers.Dense(classes)(x))


def ed_tcn(inputs, classes, filters=(64, 96), width=25):
    """Encoder and decoder, Lea et al. 2017."""
    x = entry = keras.Input((None, inputs))
    for n in filters:
        x = layers.Conv1D(n, width, padding="same")(x)
        x = layers.SpatialDropout1D(0.3)(x)
        x = layers.Lambda(norm_relu)(x)
        x = layers.MaxPooling1D(2)(x)
    for n in reversed(filters):
        x = layers.UpSampling1D(2)(x)
        x = layers.Conv1D(n, width, padding="same")(x)
        x = layers.SpatialDropout1D(0.3)(x)
        x = layers.Lambda(norm_relu)(x)
    return keras.Model(entry, layers.Dense(classes)(x))


def dilated_tcn(inputs, classes, filters=128, blocks=2, depth=5):
    """Residual blocks of dilated convolutions with gates and skips (WaveNet's), Lea et al. 2017, acausal."""
    entry = keras.Input((None, inputs))
    x = layers.Conv1D(filters, 3, padding="same", activation="relu")(entry)
    skips = []
    for _ in range(blocks):
        for layer in range(depth):
            held = x
            x = layers.Conv1D(filters, 3, padding="same", dilation_rate=2**layer)(x)
            x = layers.Lambda(norm_relu)(x)
            x = layers.Conv1D(filters, 1)(x)
            skips.append(x)
            x = layers.Add()([held, x])
    x = layers.ReLU()(layers.Add()(skips))
    x = layers.Conv1D(filters, 1, activation="relu")(x)
    return keras.Model(entry, layers.Dense(classes)(x))


def bi_lstm(inputs, classes, units=64):
    """One layer in either direction."""
    entry = keras.Input((None, inputs))
    x = layers.Bidirectional(layers.LSTM(units, return_sequences=True))(entry)
    return keras.Model(entry, layers.Dense(classes)(x))


NETWORKS = {"dt-fcn": dt_fcn, "ed-tcn": ed_tcn, "dilated-tcn": dilated_tcn, "bi-lstm": bi_lstm}
