"""AlexNet from its weights, as the shipped network was made: `lookback dev alexnet`.

weights  files of weights in torchvision's layout, read and checked
graph    weights to graphs: the network up to a layer
command  the network file of a vehicle
"""
