using System;
using System.Collections.Generic;
using UnityEngine;

namespace Clothfit
{
    /// <summary>
    /// What a scene may have besides the fields of SceneData. Only what is set is written: a list that is not empty, a
    /// number that is not NaN, a letter other than n.
    /// </summary>
    [Serializable]
    public class SceneExtras
    {
        public Vector3 gravity = Unset.Vector; // m/s²
        public KeysData windVelKeys = new KeysData(); // m/s
        public KeysData gravityKeys = new KeysData(); // m/s²
        public FrameData frame = new FrameData();
        public string planes = ""; // editor or solid
        public ContactData selfCollision = new ContactData();
        public Vector3 colliderOffset = Unset.Vector; // m
        public SceneFit fit = new SceneFit();
        public List<ObjectExtras> objects = new List<ObjectExtras>();
        public List<ColliderExtras> colliders = new List<ColliderExtras>();
    }

    [Serializable]
    public class ObjectExtras
    {
        public List<float> springRestLength = new List<float>(); // S, m
        public List<Vector3> vertVel = new List<Vector3>(); // n, m/s
        public List<PinData> pins = new List<PinData>();
        public Vector3 pinOffset = Unset.Vector; // m
        public Vector3 warp = Unset.Vector; // direction along the cloth
        public ObjectFit fit = new ObjectFit();
    }

    [Serializable]
    public class ColliderExtras
    {
        public float thickness = float.NaN; // m
        public float stiffness = float.NaN; // N/m
        public float friction = float.NaN;
        public KeysData posKeys = new KeysData(); // m
        public KeysData rotKeys = new KeysData(); // degrees
        public KeysData scaleKeys = new KeysData(); // factors
    }

    /// <summary>Values over time; as many values as times.</summary>
    [Serializable]
    public class KeysData
    {
        public List<float> times = new List<float>(); // s, increasing
        public List<Vector3> values = new List<Vector3>();
        public string interpolation = ""; // linear, smooth or hold
        public string file = ""; // in place of times and values, relative to the scene's folder

        public bool IsSet
        {
            get { return times.Count > 0 || !string.IsNullOrEmpty(file); }
        }
    }

    /// <summary>Fixed vertices that move as one.</summary>
    [Serializable]
    public class PinData
    {
        public List<int> vertices = new List<int>();
        public KeysData posKeys = new KeysData(); // m
        public KeysData rotKeys = new KeysData(); // degrees
        public Vector3 pivot = Unset.Vector; // m
    }

    /// <summary>How the axes of the scene move in those of the world.</summary>
    [Serializable]
    public class FrameData
    {
        public KeysData posKeys = new KeysData(); // m
        public KeysData rotKeys = new KeysData(); // degrees
        public Vector3 pivot = Unset.Vector; // m
    }

    /// <summary>A cloth's contact with itself; it is asked for where a number is set.</summary>
    [Serializable]
    public class ContactData
    {
        public float thickness = float.NaN; // m
        public float stiffness = float.NaN; // N/m
        public float friction = float.NaN;

        public bool IsSet
        {
            get { return Unset.Has(thickness) || Unset.Has(stiffness) || Unset.Has(friction); }
        }
    }

    /// <summary>What to fit of the scene as a whole: n nothing, G one value, L one each.</summary>
    [Serializable]
    public class SceneFit
    {
        public string windVel = "n", gravity = "n", windVelKeys = "n", friction = "n", contact = "n", colliderOffset = "n";
        public BoundsData bounds = new BoundsData();
    }

    /// <summary>What else to fit of a cloth.</summary>
    [Serializable]
    public class ObjectFit
    {
        public string damping = "n", dragCoefficient = "n", vertVel = "n", springRestLength = "n", posKeys = "n";
        public string pinOffset = "n";
        public BoundsData bounds = new BoundsData();
    }

    /// <summary>Lowest and highest value of each kind that a fit may find, in its unit: two numbers, or none.</summary>
    [Serializable]
    public class BoundsData
    {
        public List<float> mass = new List<float>(), stiffness = new List<float>(), rest = new List<float>();
        public List<float> damping = new List<float>(), drag = new List<float>(), velocity = new List<float>();
        public List<float> path = new List<float>(), shift = new List<float>(), wind = new List<float>();
        public List<float> gravity = new List<float>(), gusts = new List<float>(), friction = new List<float>();
        public List<float> contact = new List<float>(), offset = new List<float>();
    }

    /// <summary>Numbers that are not there.</summary>
    public static class Unset
    {
        public static readonly Vector3 Vector = new Vector3(float.NaN, float.NaN, float.NaN);

        public static bool Has(float number)
        {
            return !float.IsNaN(number);
        }

        public static bool Has(Vector3 vector)
        {
            return Has(vector.x);
        }
    }
}
