using System;
using UnityEngine;

namespace Clothfit
{
    /// <summary>How a cloth touches something.</summary>
    [Serializable]
    public class Contact
    {
        [Tooltip("Whether the values below count; else spheres push as in old editors, with 1000 N/m and without friction")]
        public bool own;

        [Tooltip("Distance from the surface at which it begins to push, m")]
        [Min(0f)]
        public float thickness;

        [Tooltip("Push on a vertex per depth, N/m")]
        [Min(1f)]
        public float stiffness = 1000f;

        [Tooltip("Coefficient of Coulomb friction")]
        [Min(0f)]
        public float friction;

        public ContactData Data()
        {
            return own ? new ContactData { thickness = thickness, stiffness = stiffness, friction = friction } : new ContactData();
        }

        /// <summary>Takes what a fit has found.</summary>
        public void Take(float foundStiffness, float foundFriction)
        {
            if (!own) return;
            if (Unset.Has(foundStiffness)) stiffness = foundStiffness;
            if (Unset.Has(foundFriction)) friction = foundFriction;
        }
    }

    /// <summary>A solid at the place of its object, with its rotation and size.</summary>
    [DisallowMultipleComponent]
    public abstract class ClothfitObstacle : MonoBehaviour
    {
        [Tooltip("How cloths touch it")]
        public Contact contact = new Contact();

        [Tooltip("Displacement over time, m; its change since time 0 counts")]
        public TimedKeys positionKeys = new TimedKeys();

        [Tooltip("Rotation over time, Euler angles in degrees; its change since time 0 counts")]
        public TimedKeys rotationKeys = new TimedKeys();

        [Tooltip("Factors on its size over time, above 0; those since time 0 count")]
        public TimedKeys scaleKeys = new TimedKeys();

        /// <summary>Number of its type in the file.</summary>
        public abstract int Type { get; }
    }
}
