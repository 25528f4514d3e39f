using System;
using System.Collections.Generic;
using System.Linq;
using UnityEngine;

namespace Clothfit
{
    /// <summary>How values go from one key to the next.</summary>
    public enum Interpolation
    {
        Linear,
        Smooth,
        Hold,
    }

    /// <summary>A value at a time.</summary>
    [Serializable]
    public struct TimedKey
    {
        [Tooltip("Time since the start, s")]
        public float time;

        [Tooltip("What is added to the value of the component since time 0: m for places, degrees for rotations, m/s for wind")]
        public Vector3 value;
    }

    /// <summary>Values over time, as the inspector shows them.</summary>
    [Serializable]
    public class TimedKeys
    {
        [Tooltip("Between two keys: straight, a smooth curve that is at rest at its ends, or the value of the key before")]
        public Interpolation interpolation;

        [Tooltip("Keys in the order of their times; before the first and after the last the value stays")]
        public List<TimedKey> keys = new List<TimedKey>();

        public bool IsSet
        {
            get { return keys.Count > 0; }
        }

        public KeysData Data()
        {
            if (!IsSet) return new KeysData();
            return new KeysData
            {
                times = keys.Select(key => key.time).ToList(), values = keys.Select(key => key.value).ToList(),
                interpolation = interpolation.ToString().ToLowerInvariant(),
            };
        }

        /// <summary>Takes the values of a fit, if there are as many.</summary>
        public void Take(KeysData data)
        {
            if (data.values.Count != keys.Count) return;
            for (int k = 0; k < keys.Count; k++) keys[k] = new TimedKey { time = keys[k].time, value = data.values[k] };
        }
    }

    /// <summary>What a fit may change of a value that can be one for the whole or one each.</summary>
    public enum Fitted
    {
        [Tooltip("The value stays")]
        No,

        [Tooltip("One value for all")]
        One,

        [Tooltip("One value each")]
        Each,
    }

    /// <summary>What a fit may change of masses, stiffnesses and rest lengths.</summary>
    public enum FittedMany
    {
        [Tooltip("The values stay")]
        No,

        [Tooltip("One factor on all values, which keep their proportions")]
        Factor,

        [Tooltip("One factor for each family of springs")]
        Families,

        [Tooltip("A smooth map of factors over the cloth")]
        Map,

        [Tooltip("One value for all, which flattens their pattern")]
        One,

        [Tooltip("One value each")]
        Each,
    }

    /// <summary>The letters of the file.</summary>
    public static class Letters
    {
        public static string Of(bool fitted)
        {
            return fitted ? "G" : "n";
        }

        public static string Of(Fitted fitted)
        {
            return "nGL".Substring((int)fitted, 1);
        }

        public static string Of(FittedMany fitted)
        {
            return "nFRMGL".Substring((int)fitted, 1);
        }
    }

    /// <summary>What bounds are of.</summary>
    public enum FitKind
    {
        Mass,
        Stiffness,
        Rest,
        Damping,
        Drag,
        Velocity,
        Path,
        Shift,
        Wind,
        Gravity,
        Gusts,
        Friction,
        Contact,
        Offset,
    }

    /// <summary>Lowest and highest value that a fit may find.</summary>
    [Serializable]
    public struct FitBounds
    {
        [Tooltip("Of what: mass kg, stiffness and contact N/m, rest lengths, path, shift and offset m, velocity, wind and "
            + "gusts m/s, gravity m/s²")]
        public FitKind kind;

        [Tooltip("Lowest value")]
        public float low;

        [Tooltip("Highest value")]
        public float high;

        public static BoundsData Data(List<FitBounds> bounds)
        {
            var data = new BoundsData();
            foreach (FitBounds each in bounds)
            {
                List<float> pair = each.Pair(data);
                pair.Clear();
                pair.Add(each.low);
                pair.Add(each.high);
            }
            return data;
        }

        List<float> Pair(BoundsData data)
        {
            switch (kind)
            {
                case FitKind.Mass: return data.mass;
                case FitKind.Stiffness: return data.stiffness;
                case FitKind.Rest: return data.rest;
                case FitKind.Damping: return data.damping;
                case FitKind.Drag: return data.drag;
                case FitKind.Velocity: return data.velocity;
                case FitKind.Path: return data.path;
                case FitKind.Shift: return data.shift;
                case FitKind.Wind: return data.wind;
                case FitKind.Gravity: return data.gravity;
                case FitKind.Gusts: return data.gusts;
                case FitKind.Friction: return data.friction;
                case FitKind.Contact: return data.contact;
                default: return data.offset;
            }
        }
    }
}
